"""How well whole fusions do: the report's part and its figures."""
