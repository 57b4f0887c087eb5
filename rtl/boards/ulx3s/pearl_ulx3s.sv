// SPDX-License-Identifier: MIT

// The design on a Radiona ULX3S: behind its USB serial port, 3 Mbaud, clocked with 45 MHz.
//
// Ports are named as the board's schematic names its nets; the FTDI chip receives on ftdi_rxd.
module pearl_ulx3s #(
    // 45 MHz / 3 Mbaud.
    parameter int unsigned CLOCKS_PER_BIT = 15
) (
    input  logic       clk_25mhz,
    input  logic       ftdi_txd,
    output logic       ftdi_rxd,
    // 0: out of reset. 1: a step has ended.
    output logic [7:0] led,
    // The ESP32's boot pin: low would restart the board's other half.
    output logic       wifi_gpio0
);

  localparam int unsigned DATA_WL = 32;
  localparam int unsigned ADDR_BITS = 32;

  // 25 MHz / 5 * 9; the oscillator runs 13 times as fast, at 585 MHz. The analogue settings are those
  // that Project Trellis' ecppll gives.
  logic clk, locked, rst_n;
  (* FREQUENCY_PIN_CLKI = "25", FREQUENCY_PIN_CLKOP = "45" *)
      (* ICP_CURRENT = "12", LPF_RESISTOR = "8", MFG_ENABLE_FILTEROPAMP = "1", MFG_GMCREF_SEL = "2" *)
  EHXPLLL #(
      .CLKI_DIV(5),
      .CLKFB_DIV(9),
      .CLKOP_DIV(13),
      .CLKOP_CPHASE(6)
  ) u_pll (
      .CLKI(clk_25mhz),
      .CLKFB(clk),
      .PHASESEL1(1'b0),
      .PHASESEL0(1'b0),
      .PHASEDIR(1'b1),
      .PHASESTEP(1'b1),
      .PHASELOADREG(1'b1),
      .STDBY(1'b0),
      .PLLWAKESYNC(1'b0),
      .RST(1'b0),
      .ENCLKOP(1'b0),
      .CLKOP(clk),
      .LOCK(locked)
  );

  pearl_reset u_reset (
      .clk_i  (clk),
      .ready_i(locked),
      .rst_no (rst_n)
  );

  logic [ADDR_BITS-1:0] awaddr, araddr;
  logic [DATA_WL-1:0] wdata, rdata;
  logic [DATA_WL/8-1:0] wstrb;
  logic [7:0] awlen, arlen;
  logic [2:0] awsize, arsize;
  logic [1:0] awburst, arburst, bresp, rresp;
  logic awvalid, awready, wlast, wvalid, wready, bvalid, bready;
  logic arvalid, arready, rvalid, rready;
  logic irq, unused_rlast;
  logic [3:0] unused_bid, unused_rid;

  pearl_uart_bridge #(
      .CLOCKS_PER_BIT(CLOCKS_PER_BIT)
  ) u_bridge (
      .clk_i        (clk),
      .rst_ni       (rst_n),
      .rx_i         (ftdi_txd),
      .tx_o         (ftdi_rxd),
      .m_axi_awaddr (awaddr),
      .m_axi_awlen  (awlen),
      .m_axi_awsize (awsize),
      .m_axi_awburst(awburst),
      .m_axi_awvalid(awvalid),
      .m_axi_awready(awready),
      .m_axi_wdata  (wdata),
      .m_axi_wstrb  (wstrb),
      .m_axi_wlast  (wlast),
      .m_axi_wvalid (wvalid),
      .m_axi_wready (wready),
      .m_axi_bresp  (bresp),
      .m_axi_bvalid (bvalid),
      .m_axi_bready (bready),
      .m_axi_araddr (araddr),
      .m_axi_arlen  (arlen),
      .m_axi_arsize (arsize),
      .m_axi_arburst(arburst),
      .m_axi_arvalid(arvalid),
      .m_axi_arready(arready),
      .m_axi_rdata  (rdata),
      .m_axi_rresp  (rresp),
      .m_axi_rvalid (rvalid),
      .m_axi_rready (rready)
  );

  pearl_top #(`PEARL_TOP_PARAMETERS) u_pearl (
      .clk_i        (clk),
      .rst_ni       (rst_n),
      .irq_o        (irq),
      .s_axi_awid   ('0),
      .s_axi_awaddr (awaddr),
      .s_axi_awlen  (awlen),
      .s_axi_awsize (awsize),
      .s_axi_awburst(awburst),
      .s_axi_awvalid(awvalid),
      .s_axi_awready(awready),
      .s_axi_wdata  (wdata),
      .s_axi_wstrb  (wstrb),
      .s_axi_wlast  (wlast),
      .s_axi_wvalid (wvalid),
      .s_axi_wready (wready),
      .s_axi_bid    (unused_bid),
      .s_axi_bresp  (bresp),
      .s_axi_bvalid (bvalid),
      .s_axi_bready (bready),
      .s_axi_arid   ('0),
      .s_axi_araddr (araddr),
      .s_axi_arlen  (arlen),
      .s_axi_arsize (arsize),
      .s_axi_arburst(arburst),
      .s_axi_arvalid(arvalid),
      .s_axi_arready(arready),
      .s_axi_rid    (unused_rid),
      .s_axi_rdata  (rdata),
      .s_axi_rresp  (rresp),
      .s_axi_rlast  (unused_rlast),
      .s_axi_rvalid (rvalid),
      .s_axi_rready (rready)
  );

  assign led = {6'b0, irq, rst_n};
  assign wifi_gpio0 = 1'b1;

endmodule
