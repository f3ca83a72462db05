#!/usr/bin/env bash
# Measures the backend on a GPU, from the repository's root:  bash plugins/orbit-warp/benchmarks/gpu/measure.sh STAGE ...
#   smoke     one size of Lift, small: does everything run?        about 2 minutes with a cold kernel cache
#   closed    a recorded step is the step, and waits for nothing   about 3 minutes
#   tests1, tests2, tests3   the contract's suite, a third each    about 2 minutes each
#   images    pictures against closed forms                        about 5 minutes with a cold kernel cache
#   cameras   colour and depth of Lift at 1,024 environments       about 3 minutes
#   sensors   rays, noise, delays and pictures in a step          about 4 minutes
#   torch     what PyTorch's own captures do with a step          about 4 minutes
#   bench     Lift at 4,096 and 16,384 environments                about 2 minutes
#   tasks     Reach, Cabinet and Velocity-Flat at 4,096            about 3 minutes
#   compiled  Lift at both sizes, compiled; needs Triton           about 3 minutes
#   profile   kernels and gaps of a step of Lift                   about 1 minute
#   solver    the solver in one launch against MuJoCo-Warp's: results, rounds, time    about 3 minutes
#   rounds    steps of Lift and Go1 with either solver, random and by policies         about 6 minutes
#   experts   each task's expert, 256 environments                 about 3 minutes
#   soak      16,384 environments of Lift, 10,000 random steps     about 4 minutes
#   loop      policy, step and storing as one recording; PPO's update as one graph   about 2 minutes
#   learning  collecting and learning in the steady state, RSL-RL and ORBIT's own    about 8 minutes
#   clock     seconds from the command to a learned task, on all GPUs                up to 9 minutes
#   offpolicy seconds from the command to tasks learned by SAC, side by side on all GPUs   5 minutes
#   ranks     one world on each of the machine's GPUs              about 2 minutes
# Logs go to $OUT, or to out/gpu where that is unset.
set -u
source "$(dirname "$0")/setup.sh"
out=${OUT:-out/gpu}; mkdir -p "$out"
here=plugins/orbit-warp/benchmarks/gpu
nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv,noheader

bench() {  # TASK SIZES [OPTION ...]
  local task=$1 sizes=$2; shift 2
  python3 $here/bench.py --task "$task" --num-envs $sizes "$@"
}

contract() {  # THIRD: every third file of the suite, beginning with that one
  local files=(tests/conformance/orbit_conformance/contract/test_conformance_*.py tests/conformance/test_{variants,tasks}.py) chosen=() i
  for ((i = $1 - 1; i < ${#files[@]}; i += 3)); do chosen+=("${files[i]}"); done
  python3 -m pytest -q -p no:cacheprovider -rfE "${chosen[@]}" --device cuda --junit-xml "$out/tests$1.xml" \
    -k warp
}

stage() {
  case $1 in
    smoke) bench Lift 256 --action ik_relative --steps 50 --blocks 2 ;;
    closed) python3 -m pytest -q -p no:cacheprovider -rfEs plugins/orbit-warp/tests/test_warp_gpu.py ;;
    tests[123]) contract "${1#tests}" ;;
    images) python3 -m pytest -q -p no:cacheprovider -rfE tests/conformance/test_images.py --device cuda -k warp ;;
    cameras)
      python3 $here/cameras.py --num-envs 1024 --frames 30 --json "$out/cameras.json"
      python3 $here/cameras.py --num-envs 1024 --frames 30 --json "$out/cameras_unshaded.json" --no-shadows ;;
    sensors) python3 $here/sensors.py ;;
    torch) python3 $here/torch_capture.py ;;
    bench) bench Lift "4096 16384" --action ik_relative ;;
    tasks) for task in Reach Cabinet Velocity-Flat; do bench $task 4096 || return 1; done ;;
    compiled) bench Lift "4096 16384" --action ik_relative --compile ;;
    profile) bench Lift 4096 --action ik_relative --profile "$out/step.json" ;;
    solver)
      python3 $here/solver.py --task Lift --policy lift --resident 8 24 32
      python3 $here/solver.py --task Lift
      python3 $here/solver.py --task Lift --policy lift --cone pyramidal --states 2
      python3 $here/solver.py --task Velocity-Flat --policy velocity_flat_go1
      python3 $here/solver.py --task Velocity-Flat --robot unitree_go1 --states 2 ;;
    rounds)
      local fused
      for fused in true false; do
        bench Lift 4096 --policy lift --warm 200 --steps 60 --setting fused_solver=$fused
        bench Lift 4096 --action joint_position --steps 60 --setting fused_solver=$fused
        bench Velocity-Flat 4096 --policy velocity_flat_go1 --warm 200 --steps 60 --setting fused_solver=$fused
        bench Velocity-Flat 4096 --robot unitree_go1 --steps 60 --setting fused_solver=$fused
      done ;;
    experts) python3 $here/experts.py --num-envs 256 ;;
    soak) bench Lift 16384 --action ik_relative --steps 2000 --blocks 5 ;;
    loop) python3 -m pytest -q -p no:cacheprovider -rfEs plugins/orbit-warp/tests/test_warp_loop_gpu.py ;;
    learning) python3 benchmarks/learning/speed.py --json "$out/speed.json" ;;
    clock) python3 benchmarks/learning/clock.py --seeds 0 1 2 3 4 --limit "${LIMIT:-540}" --output "$out/clock" ;;
    offpolicy)  # four trainings, dealt to the GPUs that there are
      local gpus; gpus=$(nvidia-smi -L | wc -l)
      python3 benchmarks/learning/clock.py --tasks Reach Lift Velocity-Flat Humanoid --libraries orbit:"${ALGORITHM:-sac}" \
        --side-by-side $(((3 + gpus) / gpus)) --limit "${LIMIT:-300}" --output "$out/offpolicy" ;;
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
