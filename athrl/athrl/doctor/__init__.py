"""`athrl doctor`: whether this installation and this machine can carry a run, and how a live one is."""
