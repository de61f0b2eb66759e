"""A whole run in one process and one thread, without a network or a clock, that repeats itself bit for bit.

    athrl train --serial

An actor's rollout and a learner's training take turns: one decision in every environment, then each chunk
that it completed goes into the log and the replay, and updates follow as long as the limiter owes any. What
a distributed run does every so many seconds is done every so many updates. `docs/serial.md` tells what is
guaranteed.

Only the subcommand imports this package: it needs every service's room.
"""
