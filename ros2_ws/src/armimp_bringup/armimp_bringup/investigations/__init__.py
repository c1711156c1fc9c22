"""Monte Carlo studies that answer one question each: ``armimp investigate``."""
