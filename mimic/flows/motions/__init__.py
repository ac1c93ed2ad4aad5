"""From a person to targets: files, videos, cameras."""
