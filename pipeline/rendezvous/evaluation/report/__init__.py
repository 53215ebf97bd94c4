"""The page that holds all parts of a report."""
