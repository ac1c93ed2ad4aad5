"""mimic on the maker's own firmware of the CyberDog 2, which drives this project's MuJoCo model."""
