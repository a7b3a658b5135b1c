"""Tables, figures and pages, made from the tidy rows that evaluation has computed."""
