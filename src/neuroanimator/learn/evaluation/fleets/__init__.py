"""Fleets: many emulators trained from one file, each with its row in one table, the best of each system marked.

FLEET.toml → members: systems × super steps × sizes × seeds, all checked first   fleet_file.py
  → the datasets they need, shard by shard, over the executor                    train_fleet.py
  → a training each, over the executor: dataset → emulator → errors              member.py
  → the emulator's file and its row, written by the process that was started     train_fleet.py
  → one table; finished members are not trained again
"""
