"""The learned reward in programs of others: Gymnasium environments, and pages and actions of BrowserGym."""
