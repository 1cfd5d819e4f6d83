"""The command `amusic tune` from a checkout."""

from _cli import door

if __name__ == "__main__":
    door("tune")
