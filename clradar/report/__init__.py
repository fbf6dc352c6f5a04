"""A self-contained HTML page that compares simulated images with a measured one."""

from clradar.report.page import ReportImage, html_report

__all__ = ["ReportImage", "html_report"]


def __dir__() -> list[str]:
    return sorted(__all__)
