"""The planners: networks, agents, replay and the policy artefact."""
