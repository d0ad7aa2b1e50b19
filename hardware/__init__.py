"""Where measured slots come from and go to."""
