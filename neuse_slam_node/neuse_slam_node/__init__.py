"""Latent object codes to camera poses, keyframes and pose-graph edges."""

import os

# One thread a process: the stages are processes of their own, and threads that wait for each other busily
# cost more than they bring where cores are few. Has to be set before numpy and torch are imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
