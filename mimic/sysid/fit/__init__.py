"""Residuals and least squares."""
