"""Free memory of the NVIDIA GPU that CUDA uses, from nvidia-smi, which is part of the driver."""

import os
import subprocess


def free_gpu_memory() -> int | None:
    """Free memory [bytes] of the first GPU in CUDA_VISIBLE_DEVICES, or of the first; None if it is unknown."""
    device = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")[0] or "0"
    command = ["nvidia-smi", f"--id={device}", "--query-gpu=memory.free", "--format=csv,noheader,nounits"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=30)
        return int(done.stdout.split()[0]) << 20  # in MiB
    except (OSError, ValueError, IndexError, subprocess.TimeoutExpired):
        return None
