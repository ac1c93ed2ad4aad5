"""Human motion from a video, played by a CyberDog 2 standing on its hind legs."""

__version__ = "0.1.0"
