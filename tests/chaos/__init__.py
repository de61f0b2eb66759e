"""Fault injection: a real run of real processes, killed, paused, cut off and flooded, and then audited.

    python -m tests.chaos --seed 1 --minutes 30

The seed determines the faults. Each actor records the chunks that it made and those that were acknowledged;
after an orderly end these records are compared with the learner's log, with the replay of its last
checkpoint, and with all counters. The last line is one JSON object; the exit code is 0 if everything agrees.
"""
