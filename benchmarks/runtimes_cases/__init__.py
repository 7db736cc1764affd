"""What runs an emulator, one runtime a file: each gives the cases that `runtimes.py` times in turn."""
