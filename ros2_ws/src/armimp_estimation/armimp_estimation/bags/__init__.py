"""Bags: rosbag2 recordings of experiments, written here and read whatever their origin."""
