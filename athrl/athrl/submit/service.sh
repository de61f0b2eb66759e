if ! [ -d "$run/slurm" ]; then
    echo "athrl: $(hostname) has no folder $run/slurm: the run's folder has to be on a file system that all nodes share" >&2
    exit 2
fi
unset ATHRL_SET ATHRL_RUN_FILE ATHRL_RUN ATHRL_CONNECT ATHRL_FOLDER
export PYTHONUNBUFFERED=1
for library in OMP OPENBLAS MKL NUMBA; do export ${library}_NUM_THREADS="${SLURM_CPUS_PER_TASK:-1}"; done

# Slurm sends SIGUSR1 to this script some time before the time limit: the service drains, then the job requeues
# itself. SIGTERM (scancel, requeue, preemption) goes to every process of the job: the service drains by itself.
service='' stopping='' code=0
trap 'stopping=limit; [ -z "$service" ] || kill -TERM "$service" 2>/dev/null' USR1
trap 'stopping=${stopping:-slurm}' TERM

# Run a service until it ends; if it dies, start it again, three times at most.
serve() {
    for attempt in 1 2 3 4; do
        [ -z "$stopping" ] || return
        [ "$attempt" = 1 ] || { echo "athrl: ended with code $code; restarting it" >&2; sleep "$attempt"; }
        [ -z "$stopping" ] || return  # it was asked to end meanwhile
        "$@" &
        service=$!
        [ -z "$stopping" ] || kill -TERM "$service" 2>/dev/null  # or just now, when the trap did not know it
        wait "$service"
        while kill -0 "$service" 2>/dev/null; do wait "$service"; done  # a trap ends a wait
        wait "$service"
        code=$?
        [ -z "$stopping" ] || code=0  # it was asked to end, and after a trap bash may not know its code
        case $code in 0 | 2 | 75 | 126 | 127) return ;; esac
    done
}

# Wait in the queue for the next turn; what was acknowledged is on the disk.
requeue() {
    if [ "$SECONDS" -lt 10 ]; then
        echo "athrl: ended $SECONDS s after its start, so it is not requeued: is the time limit too short?" >&2
        exit 2
    fi
    scontrol requeue "$SLURM_JOB_ID"
    exit
}
