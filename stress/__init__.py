"""Long proofs of the promises that tests check briefly; run by hand."""
