"""Reports as HTML with inline SVG, and heat maps."""
