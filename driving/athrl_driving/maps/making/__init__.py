"""How OpenDRIVE files of towns are made: a description of nodes and roads, the plan laid from it, the text.

`description` has the terms, `laying` turns them into a `plan` of roads and junctions, `writing` writes it.
`random_towns` describes the town of a seed. The descriptions of the towns that the project ships are in the
repository, in `driving/towns`.
"""
