"""Latent object codes to camera poses, keyframes and pose-graph edges."""
