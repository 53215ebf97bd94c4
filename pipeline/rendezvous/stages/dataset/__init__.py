"""What the stages that make the dataset share."""
