"""What player and trainer share and is no message: values, addresses and waits from outside, standard streams."""
