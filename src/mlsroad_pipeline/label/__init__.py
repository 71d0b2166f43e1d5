"""The product: label a survey and list its road objects."""
