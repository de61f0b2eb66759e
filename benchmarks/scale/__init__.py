"""How far a run scales: a learner, routers and actors in networks of their own, with delay and loss."""
