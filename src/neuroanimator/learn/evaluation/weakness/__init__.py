"""Where an emulator is weak: coverage of its data, error analysis, worst cases, and learning on from there."""
