"""From streams of messages to trials whose samples belong together."""
