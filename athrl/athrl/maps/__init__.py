"""`athrl maps`: the towns that come along, and a look at a map of yours."""
