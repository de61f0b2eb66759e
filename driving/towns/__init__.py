"""How the OpenDRIVE files of the towns that the project ships are made: `python -m towns`, in `driving/`."""
