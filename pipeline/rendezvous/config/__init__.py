"""`stages.yaml`, presets and `--set`, read into typed sections."""
