"""Every parser under random input: `make fuzz`."""
