"""`athrl doctor`: checks of this installation, this machine and a live run."""
