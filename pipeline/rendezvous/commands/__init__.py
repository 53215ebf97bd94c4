"""What is run on the stages' outputs."""
