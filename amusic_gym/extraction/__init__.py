"""Extraction: image folders and techniques to a score bank, or to a map for live navigation."""

from amusic_gym.extraction.blocks import BLOCK
from amusic_gym.extraction.cache import Cache, default_cache
from amusic_gym.extraction.extract import extract
from amusic_gym.extraction.map import DescribedMap, describe_map

__all__ = ["BLOCK", "Cache", "DescribedMap", "default_cache", "describe_map", "extract"]
