"""What `reinforcement.py` is made of: tasks, how their emulators are made, PPO by the clock, and who judges policies."""
