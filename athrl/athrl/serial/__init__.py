"""A complete run in one process and one thread, without network or clock, repeatable bit for bit.

    athrl train --serial

An actor's rollout and a learner's training alternate: one decision in every environment, then each completed
chunk goes into the log and the replay, and updates follow while the limiter owes any. Work that a distributed
run does after some seconds is done after some updates. What is guaranteed: `docs/how-to/serial-runs.md`.

Only the subcommand imports this package: it needs the packages of all services.
"""
