"""The acknowledged upload of chunks: the actor's side, the learner's side, and the ledger."""
