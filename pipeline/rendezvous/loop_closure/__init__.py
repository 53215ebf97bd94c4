"""Loop closure: a log's path and map once places that were seen twice are recognised."""
