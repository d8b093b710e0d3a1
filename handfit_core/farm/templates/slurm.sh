#!/bin/bash
# Hands of a plan, on SLURM: `bash THIS_FILE` submits arrays and the report that follows them. With
# `AT_ONCE=20 bash THIS_FILE` at most 20 jobs run at a time.
#SBATCH --job-name=manient
#SBATCH --cpus-per-task=4
#SBATCH --mem=@memory@M
#SBATCH --time=@minutes@
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@60

plan=@plan@
command=@command@
options=@options@
jobs=@jobs@
arrays=@arrays@ # places in jobs; each array needs those before it

submit() {
  local array id after=
  for array in "${arrays[@]}"; do
    id=$(sbatch --parsable --array="$array%${AT_ONCE:-100}" ${after:+--dependency="afterany$after"} "$0" task) ||
      exit
    after=$after:${id%%;*}
  done
  sbatch --dependency="afterany$after" "$0" report
}

task() {
  local stopped= code later
  trap 'stopped=1; kill -TERM "$!"' TERM # SLURM tells this shell alone that the time is over
  "${command[@]}" task "$plan" "${jobs[SLURM_ARRAY_TASK_ID]}" --processes "${SLURM_CPUS_PER_TASK:-1}" \
    "${options[@]}" &
  wait "$!"
  code=$?
  while [ "$stopped" ]; do # the signal has ended `wait`, and not what it waited for
    stopped=
    wait "$!"
    later=$?
    [ "$later" = 127 ] || code=$later
  done
  # 75: somebody else is at it, or another time may go better. With 1 and 2 the same would come out again.
  if [ "$code" = 75 ] && [ "${SLURM_RESTART_COUNT:-0}" -lt 5 ]; then
    scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
  fi
  exit "$code"
}

report() {
  exec "${command[@]}" collect "$plan"
}

"${1:-submit}"
