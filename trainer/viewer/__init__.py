"""What a person looks at: replays, the page, and the server behind ``corridor watch``."""
