"""The command line: parses options, calls one stage or command, prints."""
