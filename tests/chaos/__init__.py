"""A storm: a real run of real processes, killed, paused, cut off and flooded, and then held to account.

    python -m tests.chaos --seed 1 --minutes 30

The faults come from the seed. Each actor writes down what it made and what was acknowledged; after an orderly
end that is compared with the learner's log, with the replay of its last checkpoint, and with all counters.
The last line is one JSON object; the exit code is 0 if every account balances.
"""
