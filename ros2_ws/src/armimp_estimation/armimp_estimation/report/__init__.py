"""Reports: a self-contained HTML file for a result, from templates that other reports can reuse."""
