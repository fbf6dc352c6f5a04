"""One self-contained HTML page about a measurement and simulations of it."""

from clradar.report.page import ReportImage, html_report

__all__ = ["ReportImage", "html_report"]
