"""Images and clusters: what the container is made of, and what a season in one costs."""
