// SPDX-License-Identifier: MIT
// The design behind a serial line, for boards that have no faster link.
module pearl_serial #(
    parameter int unsigned CLOCKS_PER_BIT = 15
) (
    input  logic clk_i,
    input  logic rst_ni,
    input  logic rx_i,
    output logic tx_o,
    output logic irq_o
);

  localparam int unsigned DATA_WL = 32;
  // Far more than any map has, so that no address comes round again.
  localparam int unsigned ADDR_BITS = 32;

  logic [ADDR_BITS-1:0] awaddr, araddr;
  logic [DATA_WL-1:0] wdata, rdata;
  logic [DATA_WL/8-1:0] wstrb;
  logic [7:0] awlen, arlen;
  logic [2:0] awsize, arsize;
  logic [1:0] awburst, arburst, bresp, rresp;
  logic awvalid, awready, wlast, wvalid, wready, bvalid, bready;
  logic arvalid, arready, rvalid, rready;
  logic unused_rlast;
  logic [3:0] unused_bid, unused_rid;

  pearl_uart_bridge #(
      .CLOCKS_PER_BIT(CLOCKS_PER_BIT)
  ) u_bridge (
      .clk_i,
      .rst_ni,
      .rx_i,
      .tx_o,
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

  pearl_top #(
      .N_ENVS(pearl_build_pkg::N_ENVS),
      .PE_NUM(pearl_build_pkg::PE_NUM),
      .DATA_WL(DATA_WL),
      .ADDR_BITS(ADDR_BITS)
  ) u_pearl (
      .clk_i,
      .rst_ni,
      .irq_o,
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

endmodule
