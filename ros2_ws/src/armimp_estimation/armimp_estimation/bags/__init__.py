"""Bags: rosbag2 recordings of experiments, written here and read whatever their origin."""

from armimp_estimation.bags.reader import BagContent, read_bag
from armimp_estimation.bags.writer import BagWriter, require_free_space

__all__ = ["BagContent", "BagWriter", "read_bag", "require_free_space"]
