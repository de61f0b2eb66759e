# The address by which the other nodes reach this one, and a certificate for it. Edit this line if they should
# use another network.
host=$(scontrol show node "$SLURMD_NODENAME" --oneliner | grep -o ' NodeAddr=[^ ]*')
host=${host#*=}
host=${host:-$(hostname)}
"${athrl[@]}" certificates "$run/certificates" --if-missing --names "$host" >/dev/null || exit

serve "${athrl[@]}" learner --resume-if-present "${settings[@]}" --certificates "$run/certificates" --reached-as "$host"

case $stopping,$code in
limit,*) requeue ;;
,0) scancel --user="$UID" --name="$actors" --state=PENDING ;;  # the run is finished
,*) for job in "$actors" "$evaluator"; do scancel --user="$UID" --name="$job"; done ;;  # useless without it
esac
exit "$code"
