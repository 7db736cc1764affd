"""From physics to an emulator: data, training, evaluation; and what needs both."""
