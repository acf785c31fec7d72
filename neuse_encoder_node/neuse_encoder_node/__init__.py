"""Segmented RGB-D images to latent object codes."""
