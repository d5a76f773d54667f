"""All modules of compiled loops."""

from ringwear_par.compiled import (
    contact_rows,
    error_rows,
    hessian_rows,
    product_rows,
    step_rows,
    system_rows,
)

LOOPS = (product_rows, contact_rows, hessian_rows, system_rows, error_rows, step_rows)
