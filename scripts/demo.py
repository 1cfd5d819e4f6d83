"""The command `amusic demo` from a checkout."""

from _cli import door

if __name__ == "__main__":
    door("demo")
