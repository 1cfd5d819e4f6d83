"""The command `amusic reproduce` from a checkout."""

from _cli import door

if __name__ == "__main__":
    door("reproduce")
