#!/usr/bin/env bash
# Measures the backend on a GPU, from the repository's root:  bash plugins/orbit-warp/gpu/measure.sh STAGE ...
#   smoke    one size of Lift, small: does everything run?       about 2 minutes with a cold kernel cache
#   tests    the contract's suite on the GPU                     about 4 minutes
#   bench    the tasks at 4,096 environments and Lift at 16,384  about 4 minutes
#   profile  kernels and gaps of a step of Lift                  about 1 minute
#   experts  each task's expert, 256 environments                about 3 minutes
#   soak     16,384 environments of Lift, 10,000 random steps    about 4 minutes
#   ranks    one world on each of the machine's GPUs             about 2 minutes
# Logs go to $OUT, or to out/gpu where that is unset.
set -u
source "$(dirname "$0")/setup.sh"
out=${OUT:-out/gpu}; mkdir -p "$out"
here=plugins/orbit-warp/gpu
nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv,noheader

stage() {
  case $1 in
    smoke) python3 $here/bench.py --task Lift --action ik_relative --num-envs 256 --steps 50 --blocks 2 ;;
    tests) python3 -m pytest -q -p no:cacheprovider -rfE --maxfail=30 tests/conformance --device cuda \
             -k "warp and not images and not expert and not trot" ;;
    bench)
      python3 $here/bench.py --task Lift --action ik_relative --num-envs 4096 16384
      for task in Reach Cabinet Velocity-Flat; do python3 $here/bench.py --task $task --num-envs 4096; done ;;
    profile) python3 $here/bench.py --task Lift --action ik_relative --num-envs 4096 --profile "$out/step.json" ;;
    experts) python3 $here/experts.py --num-envs 256 ;;
    soak) python3 $here/bench.py --task Lift --action ik_relative --num-envs 16384 --steps 2000 --blocks 5 ;;
    ranks) python3 -m torch.distributed.run --nproc-per-node "$(nvidia-smi -L | wc -l)" $here/ranks.py ;;
    *) echo "no stage '$1'"; return 2 ;;
  esac
}

failed=0
for name in "$@"; do
  echo "== $name"
  set -o pipefail
  stage "$name" 2>&1 | tee "$out/$name.log" || failed=1
done
exit $failed
