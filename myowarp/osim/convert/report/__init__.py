"""What a conversion is worth, as data and as a page."""
