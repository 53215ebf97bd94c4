"""The figures on a dataset's card."""
