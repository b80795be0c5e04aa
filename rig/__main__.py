"""`python -m rig`: the same as `rig`, which imports nothing from the current folder either."""

import sys

if __name__ == "__main__":
    if not sys.flags.safe_path:
        del sys.path[0]  # the current folder, which Python puts there for -m
    from rig.cli.main import main

    main()
