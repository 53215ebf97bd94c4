"""Tests, which run on one thread each: there is a process of them on each core."""

import os

from rendezvous.engine.pool import ONE_THREAD

os.environ.update(ONE_THREAD)
