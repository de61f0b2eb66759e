"""Sessions: addresses, monitoring and reconnection, and closing."""
