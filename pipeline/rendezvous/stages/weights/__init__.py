"""Finding, reading and describing weights files."""
