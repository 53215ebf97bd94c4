"""The seven stages in the order of `stages.yaml`: each loads, calls a room, saves."""
