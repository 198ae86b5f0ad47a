"""What the ``corridor`` command can do: of each command, its options and what it runs.

A module here declares the options and imports nothing that takes long: no PyTorch and nothing that needs it, no
Gymnasium, gRPC or Matplotlib. ``run`` first refuses what can't be done, and then imports what does it. So help and
refusals come at once (``test_start.py`` holds every command to it).
"""
