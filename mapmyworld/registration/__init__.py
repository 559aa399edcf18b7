"""Two observations become a relative pose and its information."""
