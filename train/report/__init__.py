"""One page that shows what a comparison found."""
