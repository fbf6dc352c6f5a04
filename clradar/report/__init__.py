"""Self-contained HTML pages: simulated images against a measured one, and one image."""

from clradar.report.page import ReportImage, html_report, image_report

__all__ = ["ReportImage", "html_report", "image_report"]


def __dir__() -> list[str]:
    return sorted(__all__)
