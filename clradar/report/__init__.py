"""Self-contained HTML pages: a measured image and simulated ones, over frames too, or one image."""

from clradar.report.frames import FrameSeries
from clradar.report.frames_page import frames_report
from clradar.report.page import ReportImage, html_report, image_report

__all__ = ["FrameSeries", "ReportImage", "frames_report", "html_report", "image_report"]


def __dir__() -> list[str]:
    return sorted(__all__)
