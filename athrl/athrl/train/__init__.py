"""A whole run on one machine: the services as processes of their own, watched over and shown."""
