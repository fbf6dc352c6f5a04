"""Self-contained HTML pages: a measured image and simulated ones, or one image."""

from clradar.report.page import ReportImage, html_report, image_report

__all__ = ["ReportImage", "html_report", "image_report"]


def __dir__() -> list[str]:
    return sorted(__all__)
