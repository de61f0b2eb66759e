"""Updates: the device, the trainer, memory, and what happens when training diverges."""
