import "./page/style.css";
import { App } from "./page/app";

void new App().start();
