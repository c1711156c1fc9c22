"""Alignment of message streams to trials whose samples belong together."""
