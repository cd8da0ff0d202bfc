-- Going back to what served before is told apart from promoting it again.
ALTER TABLE promotions ADD COLUMN rolled_back INTEGER NOT NULL DEFAULT 0 CHECK (rolled_back IN (0, 1));
