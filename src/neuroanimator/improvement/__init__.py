"""Learning where an emulator is weak: look for it, simulate there, train on, and keep what was known."""
