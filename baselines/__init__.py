"""What ZOAC is compared with; each file is one tuner or one library of them."""
