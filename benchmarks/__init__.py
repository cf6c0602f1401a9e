"""Speed, measured in one run beside a rival; never asserted in tests."""
