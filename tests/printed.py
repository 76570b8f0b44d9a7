"""Models as the paper prints them: terms, and the values of its tables."""

VALVE = ["y[k-1]", "phi1[k-2]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]"]
PRINTED = [1, -19.76, 19.32, 9.44, -12.61]
BENCH = [
    "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
    "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip
TABLE_1 = [1.00, 0.77, 1.44e-2, -9.60e-3, 3.15e-4, -2.47e-4]
INVERSE = [
    "u[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]", "phi2[k-1]*phi1[k-1]*y[k-1]",
    "phi2[k-1]*y[k-1]*u[k-1]", "phi2[k-1]*y[k-1]**2",
]  # fmt: skip
INVERSE_TABLE_1 = [1.00, 1.27, -2.13e-2, 1.37e-2, -1.07e-5, 7.99e-6]
