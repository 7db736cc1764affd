// The worker that descends, so that the page never stutters.

import { serve, type Port } from "./serve";

serve(self as unknown as Port);
