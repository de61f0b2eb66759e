serve "${athrl[@]}" "${command[@]}" --connect "$run" --certificates "$run/certificates"

# 75: there was no learner for long. While its job waits, this one makes room for it and waits, too.
case $stopping,$code in
limit,*) requeue ;;
,75) [ -z "$(squeue --noheader --user="$UID" --name="$learner")" ] || requeue ;;
esac
exit "$code"
