"""Demonstrations: scripted demonstrators, recording them, and importing those of other files."""

from .pictures import draw_contact_sheet

__all__ = ["draw_contact_sheet"]
