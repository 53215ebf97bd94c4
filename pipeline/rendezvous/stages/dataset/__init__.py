"""Parts of the stages that make the dataset."""
