"""People in the loop: a page on which a person judges and corrects episodes of the policy."""
