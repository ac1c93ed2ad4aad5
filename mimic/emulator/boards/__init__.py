"""Emulated boards that drive all motors themselves: CyberDog 2's and Go2's."""
