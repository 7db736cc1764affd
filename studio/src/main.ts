import "./page/style.css";
import { App } from "./page/app";
import { takeToken } from "./server/token";

takeToken();
void new App().start();
