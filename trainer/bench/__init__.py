"""What ``corridor bench`` measures."""
