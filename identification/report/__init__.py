"""The report: a fit and a diagnosis as one HTML page that needs no network, no script and no other file."""

from __future__ import annotations

from identification.report.report import build_document, write_report

__all__ = ["build_document", "write_report"]
