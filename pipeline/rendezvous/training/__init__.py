"""The training loop, batches, checkpoints and settings."""
