"""How well frame errors are estimated: the report's part and its figures."""
