"""The command `amusic rewards` from a checkout."""

from _cli import door

if __name__ == "__main__":
    door("rewards")
