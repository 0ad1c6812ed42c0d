"""Requirements of the arm, and the tests and campaigns that show them."""
