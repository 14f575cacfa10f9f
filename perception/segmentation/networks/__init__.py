"""The networks: forward passes only, without files or training."""
