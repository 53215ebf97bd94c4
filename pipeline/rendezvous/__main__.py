"""`python -m rendezvous`: the command line."""

from rendezvous.cli.__main__ import main

if __name__ == "__main__":
    main()
