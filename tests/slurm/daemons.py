"""A real Slurm on this machine: a controller and several nodes, each a `slurmd` with a name and an address.

    python -m tests.slurm.daemons FOLDER

starts one and keeps it until Ctrl-C, or the end of its input. It needs Slurm's daemons (on Debian 12:
`apt-get install slurmctld slurmd slurm-client`), and root, if the node `island` is not to share the folder
FOLDER/shared/runs.
"""

from __future__ import annotations

import contextlib
import os
import pwd
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import psutil

NODES = ("n1", "n2", "n3", "island")
START_SECONDS = 60.0
STOP_SECONDS = 15.0

_CONFIGURATION = """\
ClusterName=test
SlurmctldHost=localhost
SlurmctldPort={ports[4]}
AuthType=auth/none
CredType=cred/none
# After a requeue Slurm waits until the job's old credential has expired; 120 s by default.
AuthInfo=cred_expire=5
SlurmUser={user}
SlurmdUser={user}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd-%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
SwitchType=switch/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=bf_interval=2,sched_interval=2
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
SlurmdParameters=config_overrides
ReturnToService=2
KillWait=30
NodeName=n1 NodeHostname=localhost NodeAddr=127.0.0.11 Port={ports[0]} CPUs=2
NodeName=n2 NodeHostname=localhost NodeAddr=127.0.0.12 Port={ports[1]} CPUs=2
NodeName=n3 NodeHostname=localhost NodeAddr=127.0.0.13 Port={ports[2]} CPUs=2
NodeName=island NodeHostname=localhost NodeAddr=127.0.0.14 Port={ports[3]} CPUs=2
PartitionName=main Nodes=n1,n2 Default=YES MaxTime=60
PartitionName=preemptible Nodes=n3 PriorityTier=1 PreemptMode=REQUEUE
PartitionName=urgent Nodes=n3 PriorityTier=10 PreemptMode=OFF
PartitionName=island Nodes=island
PartitionName=closed Nodes=n1 State=DOWN
"""


def configuration(folder: Path) -> Path:
    """Return the place of the configuration of the cluster in a folder: the value of SLURM_CONF."""
    return folder / "slurm" / "slurm.conf"


@contextlib.contextmanager
def daemons(folder: Path) -> Iterator[None]:
    """Run the daemons while the block runs; all their files are in `folder`, which is new."""
    conf, hidden = configuration(folder), folder / "shared" / "runs"
    for place in (hidden, conf.parent / "state", conf.parent / "spool"):
        place.mkdir(parents=True)
    user = pwd.getpwuid(os.getuid()).pw_name
    conf.write_text(_CONFIGURATION.format(folder=conf.parent, user=user, ports=_free_ports(5)))
    isolation = ["unshare", "--mount", "sh", "-c", 'mount -t tmpfs none "$0" && exec "$@"', str(hidden)]
    with ExitStack() as stack:
        _start(["slurmctld", "-D"], conf, stack)
        for name in NODES:
            isolated = isolation if name == "island" and os.getuid() == 0 else []
            _start([*isolated, "slurmd", "-D", "-N", name], conf, stack)
        stack.callback(_end_jobs, conf)
        _await_nodes(conf)
        yield


def processes_of_jobs(conf: Path) -> list[psutil.Process]:
    """Return all processes of a cluster's jobs, also of nodes that are gone."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            environment = process.environ()
            if environment.get("SLURM_CONF") == str(conf) and "SLURM_JOB_ID" in environment:
                found.append(process)
    return found


def _start(words: list[str], conf: Path, stack: ExitStack) -> None:
    """Start a daemon, which ends with `stack`, or is killed."""
    with (conf.parent / f"{words[-1].strip('-')}.out").open("wb") as output:
        daemon = subprocess.Popen(
            [*words, "-f", str(conf)],
            env=_environment(conf),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,  # Ctrl-C is for this process, which ends them in order
        )
    stack.callback(_end, daemon)


def _end(daemon: subprocess.Popen[bytes]) -> None:
    daemon.send_signal(signal.SIGTERM)
    try:
        daemon.wait(STOP_SECONDS)
    except subprocess.TimeoutExpired:
        daemon.kill()
        daemon.wait(STOP_SECONDS)


def _end_jobs(conf: Path) -> None:
    """Cancel all jobs, give them a moment, and kill what is left of them."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        subprocess.run(
            ["scancel", f"--user={os.getuid()}"],
            env=_environment(conf),
            timeout=STOP_SECONDS,
            capture_output=True,
            check=False,
        )
    deadline = time.monotonic() + STOP_SECONDS
    while processes_of_jobs(conf) and time.monotonic() < deadline:
        time.sleep(0.2)
    for process in processes_of_jobs(conf):
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()


def _await_nodes(conf: Path) -> None:
    deadline, words = time.monotonic() + START_SECONDS, ["sinfo", "--noheader", "--Node", "--format=%T"]
    while time.monotonic() < deadline:
        shown = subprocess.run(words, env=_environment(conf), capture_output=True, text=True, check=False)
        if set(shown.stdout.split()) == {"idle"}:
            return
        time.sleep(0.5)
    raise SystemExit(f"no nodes within {START_SECONDS:g} s: see {conf.parent}")


def _environment(conf: Path) -> dict[str, str]:
    return {**os.environ, "SLURM_CONF": str(conf)}


def _free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        probes = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(count)]
        return [int(probe.getsockname()[1]) for probe in probes]


def main() -> None:
    """Keep a cluster until Ctrl-C or the end of the input."""
    folder = Path(sys.argv[1]).resolve()
    with contextlib.suppress(KeyboardInterrupt), daemons(folder):
        print(f"export SLURM_CONF={configuration(folder)}", flush=True)
        while sys.stdin.read(1):
            pass


if __name__ == "__main__":
    main()
