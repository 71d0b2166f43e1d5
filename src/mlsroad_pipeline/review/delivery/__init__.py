"""Delivery of a survey after its check: corrected inventory and points, and the protocol of the check."""
