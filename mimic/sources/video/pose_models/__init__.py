"""Networks that find people in pictures, and the files that they are in."""
