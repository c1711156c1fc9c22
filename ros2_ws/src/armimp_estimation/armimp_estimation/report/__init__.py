"""Reports: a self-contained HTML file for a result, from templates that other reports can reuse."""

from armimp_estimation.report.run import REPORT_FILE, report_page, write_report

__all__ = ["REPORT_FILE", "report_page", "write_report"]
