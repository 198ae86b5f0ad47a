"""What the ``corridor`` command can do: of each command, its options and what it runs.

Whatever takes long to import is imported when a command runs, so that help and refusals come at once.
"""
